"""Records and messages of a journal as tables: CSV and Parquet (docs/journal.md)."""
