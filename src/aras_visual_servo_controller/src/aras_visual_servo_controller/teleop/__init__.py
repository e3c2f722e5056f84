"""Teleoperation of the arm by keyboard or gamepad."""
