"""``python -m prc_cli`` is the command ``prc``."""

from prc_cli.cli import main

if __name__ == "__main__":
    main()
