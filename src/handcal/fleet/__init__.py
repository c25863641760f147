"""A fleet: every recording explained, on as many machines as there are, and what is kept of it.

Reading order: ``sources`` (which recordings, of which device and model; ``remote``: at addresses),
``told``, ``laws`` and ``work`` (what is made of one, in a process of its own), ``worker_process``
and ``supervise`` (that process, and who watches it), ``store`` (what is kept, by which key),
``run``, ``dataset`` (Parquet), and ``results``, which hands all of it to ``handcal.population``.
"""
