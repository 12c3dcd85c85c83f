"""The engine's parts on files of others: optimised pose graphs and merged maps, reported and drawn."""
