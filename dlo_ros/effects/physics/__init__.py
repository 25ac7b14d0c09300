"""Effects that change the rod, what holds it or what it touches."""
