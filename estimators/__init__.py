"""Estimators: from joint motion to joint torque.

`rigid_body` identifies an arm, `hybrid` adds a network to a simulation, `evaluation` judges both on
motion they have not seen. Import from the modules: torch is loaded only where something is trained.
"""
