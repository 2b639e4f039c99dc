"""`python -m agent.cli` is the command `coop`."""

from agent.cli.main import main

main()
