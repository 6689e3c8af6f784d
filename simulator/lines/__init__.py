"""The simulator's ends of lines that a gateway opens."""
