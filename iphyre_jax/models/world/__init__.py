"""World models: what will the scene look like in 0.1 s, and what becomes of a plan that is only imagined?"""
