"""All that speaks Hydra: overrides, composition, launchers and sweepers."""
