"""The driver of a batch, the worker of a task, and what they exchange."""
