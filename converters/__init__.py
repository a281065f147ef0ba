"""Scenes of this project as scenes of other programs; nothing here traces a ray."""
