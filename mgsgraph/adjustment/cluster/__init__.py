"""Work over several processes or machines by dask.distributed: workers of one's own, or a scheduler that runs already.

The only room that knows dask, and knows it only when it is asked for: the package works without it.
"""
