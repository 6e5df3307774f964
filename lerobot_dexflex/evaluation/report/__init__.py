"""Tables, plots, videos and the HTML page of a comparison; nothing here changes an episode."""
