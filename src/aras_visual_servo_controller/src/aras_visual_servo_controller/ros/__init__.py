"""ROS interface of the controller: conversion of messages, topics, services and the node."""
