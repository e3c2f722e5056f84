"""Command-line clients: spawn_model, spawner, unspawner, controller_manager."""
