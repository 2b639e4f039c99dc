"""What a process of ours needs of its host: signals, scheduling, paths, children, the service manager."""
