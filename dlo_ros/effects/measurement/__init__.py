"""Effects that change how and when a DLO is seen, or what is known of it; its physics stay."""
