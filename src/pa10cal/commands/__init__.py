"""What can be asked of pa10cal from a shell, one function a command."""
