"""`python -m conflank_cli` is `conflank`."""

from conflank_cli.cli import main

if __name__ == "__main__":
    main()
