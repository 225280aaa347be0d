"""What the figures of the READMEs come from; `table.py` names every benchmark."""
