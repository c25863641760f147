"""Commands of the simulator, found like those in ``handcal.commands``."""
