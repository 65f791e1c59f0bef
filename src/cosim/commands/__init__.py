"""Everything a terminal sees, one file a command."""
