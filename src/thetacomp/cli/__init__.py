"""The commands of thetacomp, one thin file each."""
