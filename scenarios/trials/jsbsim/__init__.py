"""Flights by JSBSim, a simulator that is not the project's: truths that share no equation with the models here."""
