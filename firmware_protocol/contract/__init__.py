"""What gateway and mapper share: key expressions and records (CONTRACT.md)."""
