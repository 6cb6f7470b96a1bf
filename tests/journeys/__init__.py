"""What must hold from end to end.

Each journey of a user as commands that are typed, and a figure.
"""
