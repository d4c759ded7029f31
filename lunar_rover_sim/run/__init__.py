"""One run of the graph: scenario, plan, lockstep, node processes, recording."""
