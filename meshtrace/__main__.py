"""`python -m meshtrace`: the command line."""

from meshtrace.cli import main

if __name__ == "__main__":
    main()
