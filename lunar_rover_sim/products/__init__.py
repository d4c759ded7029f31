"""What is made of a recording: checks, pictures, exported sequences, OpenUSD stages."""
