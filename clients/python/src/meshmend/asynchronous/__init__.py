"""The asynchronous client of the service. The synchronous client is generated from it."""
