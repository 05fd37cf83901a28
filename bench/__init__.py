"""How fast, how small and how exact the project is; each file measures one side of it."""
