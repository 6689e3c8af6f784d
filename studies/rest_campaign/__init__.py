"""What the mapper's OpenAPI document says, held against the mapper: thousands of generated requests to a running site."""
