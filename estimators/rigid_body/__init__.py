"""Rigid-body estimator: base parameters and physically consistent inertias from recordings."""

from estimators.rigid_body.base_parameters import Conditioning
from estimators.rigid_body.fitting.normal_equations import Rows
from estimators.rigid_body.identification import Identification, identify
from estimators.rigid_body.model import RigidBodyModel
from estimators.rigid_body.terms import JointTerms, Term

__all__ = [
    "Conditioning",
    "Identification",
    "JointTerms",
    "RigidBodyModel",
    "Rows",
    "Term",
    "identify",
]
