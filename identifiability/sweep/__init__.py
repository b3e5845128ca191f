"""Many independent tasks over processes: resumable, and none can take another with it.

`run` is the way in; `keep` knows what is done, `runner` how it is done, `worker` what runs in the
other processes, `bar` how far it is.
"""
