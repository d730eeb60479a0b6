"""One thin module per subcommand: words into calls. Numerics are imported when a command runs."""
