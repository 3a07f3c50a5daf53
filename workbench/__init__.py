"""Face Energy Workbench: facial performance capture by optimisation."""
