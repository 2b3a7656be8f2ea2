"""Everything that depends on Hydra: overrides, composition, launchers and sweepers."""
