"""``python -m slamkit.cli`` is the command ``slamkit``."""

from slamkit.cli.app import main

if __name__ == "__main__":
    main()
