"""Fleet: one place that several live sessions use and extend at the same time, over MQTT."""
