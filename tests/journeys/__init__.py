"""What must hold from end to end: each journey of a user as commands that are typed, and a figure."""
