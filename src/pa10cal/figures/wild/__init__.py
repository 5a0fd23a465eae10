"""Pictures of wild trials: campaigns with stressors and faults."""
