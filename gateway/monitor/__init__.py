"""What the gateway says of itself over HTTP."""
