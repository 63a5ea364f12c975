"""A bank and a robot in one model, and environments of it for Gymnasium."""
