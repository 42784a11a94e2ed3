"""The front door: the `loopcal` command. Composes the rooms below and holds no logic of theirs."""
