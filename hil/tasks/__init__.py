"""What `import hil` offers: each task of the bench as a function or a method, on the same functions as the command line."""
