"""The transfer system of a hybrid test: actuators, their delay and its compensation, tracking."""
