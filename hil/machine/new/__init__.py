"""Writing a new machine file: from answers, from a MuJoCo or URDF model, with data sheets of drives."""
