"""Faults by the thousand on a whole site, and the account of every encounter that its backpacks reported."""
