"""Constants of joints and drives, fitted so that the arm simulated forward stays where it was."""
