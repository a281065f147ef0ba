"""The commands of `whitted`, a file each; what they share is in errors, inputs, outputs and signals."""
