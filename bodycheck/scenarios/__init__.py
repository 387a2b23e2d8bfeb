"""What is simulated: the scenario model, its TOML reader, and a library of scenarios with sources."""
