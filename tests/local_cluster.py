"""A Dask cluster of two workers on this machine, for tests, until standard input ends.

Prints the scheduler's address and then, for each line of standard input, the processes of its
workers. It listens on the loopback alone: whoever reaches a scheduler may run anything there.
"""

import json
import os
import sys

from distributed import Client, LocalCluster


def main():
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
        ) as cluster,
        Client(cluster) as client,
    ):
        print(cluster.scheduler_address, flush=True)
        for _ in sys.stdin:
            pids, tasks = client.run(os.getpid), client.processing()
            told = [{"pid": pid, "tasks": len(tasks.get(of, ()))} for of, pid in pids.items()]
            print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
