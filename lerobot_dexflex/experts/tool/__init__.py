"""The reactive operator of the tasks: one hand for every tool, scripts that say where the tool goes."""
