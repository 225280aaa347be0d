"""Layouts of image folders: the table that recognises them, and their readers."""
