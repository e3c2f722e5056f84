"""Messages, services and helpers of the controller manager."""
