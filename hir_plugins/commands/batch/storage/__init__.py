"""Files of a batch: stores, the layout of the destination, the lease, and the local folders of workers."""
