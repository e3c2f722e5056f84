"""Has the camera arrived, and if not, why: outcomes and the advice that goes with them."""
