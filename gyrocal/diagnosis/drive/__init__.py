"""Diagnosis of drive logs: what the encoders, the gyro and the truth disagree about."""
