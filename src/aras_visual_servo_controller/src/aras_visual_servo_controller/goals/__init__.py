"""What the camera is to see and where the arm stands then: goals and starts."""
