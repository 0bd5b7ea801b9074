"""Every stage driven to its limits: `python -m benchmarks stress [--full]`."""
