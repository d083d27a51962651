"""``python -m structid``: the command line."""

from structid.cli.main import main

if __name__ == "__main__":
    main()
