"""One agent on a real network: its journal, its link to the others, its own time."""
