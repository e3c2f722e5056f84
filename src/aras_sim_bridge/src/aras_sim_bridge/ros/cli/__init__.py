"""Command-line programs: spawn_model, spawner, unspawner, controller_manager and others."""
