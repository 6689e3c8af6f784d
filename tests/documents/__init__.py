"""What the documents say is true: their commands run, and all that the code offers is in them."""
