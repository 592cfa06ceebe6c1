"""The observer's workshop: its model from frequency responses, its noise from records, its tuning, its replay over recordings."""
