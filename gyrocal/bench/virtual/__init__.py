"""The virtual bench: one physical model behind virtual devices."""
