"""Error beside cost: what each method, step and precision costs on a scene, and how wrong it is."""
