"""From neutral tool path to machine control; knows nothing of conflank_cli."""
