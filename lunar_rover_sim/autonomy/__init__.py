"""How a rover decides: path following, mapping and planning, learned policies."""
