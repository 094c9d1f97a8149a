"""The joint estimate: unknown scales of noise and range errors, learned and integrated over."""
