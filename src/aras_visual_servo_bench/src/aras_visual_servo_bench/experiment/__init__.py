"""What was asked for: experiments, starts, cameras, robots, and the parts made from them."""
