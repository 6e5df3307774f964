"""The controller's training data: in-hand reaching under corrupted commands, as shards of tensors."""
