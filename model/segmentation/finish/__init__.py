"""Finish labels: whole facets and shells, attached shells, small components, small parts."""
