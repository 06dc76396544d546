"""Message stubs generated from proto/ by `make stubs`."""
