"""Settings: every number of the diagnosis that somebody chose, by stage, in one place.

They are constants: nothing changes them while a program runs. `docs/diagnosis_settings.md` lists
them; whoever changes one writes it anew:

    python -m estimators.diagnosis.settings.table docs/diagnosis_settings.md
"""
