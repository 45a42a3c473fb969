"""Updates of a group that an elected robot has solved: a new match costs what it changes."""
