"""Every message type, its checks and its accounting."""
