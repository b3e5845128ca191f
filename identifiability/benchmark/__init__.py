"""Joints whose missing effect is known, to judge whether an investigation names it.

The equations and the integrator are this folder's own and share nothing with the models that are
fitted: a benchmark made by the fitted code could not show that its equations are wrong.
"""
