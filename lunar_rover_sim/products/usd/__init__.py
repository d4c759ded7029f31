"""World, rover and drive as OpenUSD stages."""
