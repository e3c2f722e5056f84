"""Messages and services of the controller manager, and functions that use them."""
