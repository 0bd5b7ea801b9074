"""What command lines are made of: groups of commands, arguments, pipes, progress, figures and closing sentences."""
