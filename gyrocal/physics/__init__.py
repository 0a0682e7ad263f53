"""The catalogue of effects and the error surface. numpy alone."""
