"""Parameters of the paper's model as readers know them, made those that it is solved in."""

import numpy as np

from pa10cal.terms.joint_spring import JointSpring


def solved_parameters(model, reported):
    """Return the parameters (k,) of a model, from the values that it reports by their names."""
    parts = []
    for term in model.terms:
        if isinstance(term, JointSpring):
            k_lin = reported[f"K_lin_{term.joint}"]
            parts.append(term.solved(k_lin, reported[f"K_cub_{term.joint}"]))
        else:
            parts.append(np.array([reported[parameter.name] for parameter in term.parameters]))
    return np.concatenate(parts)
