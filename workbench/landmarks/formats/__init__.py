"""Layouts of landmark files, the workbench's own and those of other programs; `landmarks.files` chooses among them."""
