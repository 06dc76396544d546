"""Message stubs generated from proto/ by scripts/make_stubs.sh."""
