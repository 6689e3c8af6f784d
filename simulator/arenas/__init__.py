"""Areas to walk in: where they come from, what is known of their shape, and shortest paths within them."""
