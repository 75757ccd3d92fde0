"""What is checked of plans and steps before anybody uses them."""
