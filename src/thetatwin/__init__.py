"""The virtual machine: heat, deformation, sensors and instruments from physics, a truth to be judged by."""
