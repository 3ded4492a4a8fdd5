"""Files in other people's formats."""
