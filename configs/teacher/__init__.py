"""Named teachers beside the registered controllers: ``teacher=<name>``."""
