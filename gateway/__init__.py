"""The base-station service: radios in, journal, Zenoh out, commands back."""
