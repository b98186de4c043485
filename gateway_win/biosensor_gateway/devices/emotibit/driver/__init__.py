"""The driver of EmotiBits."""
