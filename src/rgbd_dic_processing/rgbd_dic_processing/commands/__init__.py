"""The sub-commands of `rgbd-dic`: each has `add_parser(commands)` and `run(options)` that returns the exit code."""
