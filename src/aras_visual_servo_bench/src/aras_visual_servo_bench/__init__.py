"""Visual servoing experiments: what joins the simulator, the camera and the controller."""
