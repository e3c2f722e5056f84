"""An experiment carried out: the closed loop, and the Gymnasium environment."""
