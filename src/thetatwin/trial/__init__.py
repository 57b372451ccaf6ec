"""Trials on the virtual machine: a year at work after some days of training, and the verification of many machines."""
