"""Calls into an FMU's library, in a process of its own. Standard library only, so that the process starts quickly."""
