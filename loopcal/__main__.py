"""`python -m loopcal` is the `loopcal` command."""

from loopcal.cli import main

main()
