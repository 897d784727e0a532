"""Policy search on cells: value iteration, bounds, and which relations and cells are tried."""
