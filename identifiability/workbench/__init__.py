"""An investigation that is steered by hand: look, rank, add, compare, go back.

- `attempt`: a model that was weighed and fitted, and what one effect more would bring.
- `difference`: two models side by side, and where they differ.
- `moves`: what was done, and the trials, in a folder.
- `notebook`: what a session finds is shown in one as well.
- `session`: the history of models that one goes back and forth in.
- `show`: how these show themselves in a notebook.
"""
