"""Access control on the network: roles, certificates, and Zenoh's configuration for each role."""
