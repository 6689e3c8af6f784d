"""The commands of ``biobot-gateway``, one module for those that belong together; each adds its flags and does its work."""
